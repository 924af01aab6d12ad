"""Roles of recordings (fit, selection, test): the motion of every axis in each, their assignment, and what a role lacks."""
