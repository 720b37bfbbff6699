"""Robots: one folder each, with what is the robot's own; calibrations, which all share; which kinds there are."""
