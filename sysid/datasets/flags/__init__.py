"""Detection of sensor faults in the raw channels; no value is changed."""
