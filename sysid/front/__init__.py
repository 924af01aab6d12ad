"""What ``import sysid`` offers: one function for each verb of the command line, which calls the same function."""
