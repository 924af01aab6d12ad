"""Reinforcement learning on fitted models: environments, paths, inverse kinematics, tracking. Only the trainer loads torch."""
