"""Plants written for other simulators, each with a replay that compares the export with the plant and with the machine."""
