"""What moves a machine, on plants and networks of :mod:`sysid`, which never imports it.

- :mod:`sysid_rl.control`: controllers of cylinders and of hanging tools
- :mod:`sysid_rl.train`: environments, policies, their training, tracking of paths
- :mod:`sysid_rl.run`: a policy or inverse kinematics on a machine, supervised and recorded
- :mod:`sysid_rl.cli`: the verbs ``sysid train``, ``track`` and ``run``
"""
