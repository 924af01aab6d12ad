"""The hardware runner: sensors → joints → end effector → policy → setpoints → cylinder controller → supervisor → valves.

Nothing here loads torch. The supervisor evaluates whatever the policy asks for; the machine's side times out by itself.
"""
