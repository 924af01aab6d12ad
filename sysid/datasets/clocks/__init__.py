"""The clocks of devices against the machine's: found from motion that both have seen, with intervals, in pieces where set."""
