"""The hardware runner: sensors → joints → end effector → policy → setpoints → cylinder controller → supervisor → valves.

Nothing here loads torch. The supervisor is independent of the policy; the machine has its own time-out.
"""
