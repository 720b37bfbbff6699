"""Robots: one folder each, with what is the robot's own; which kinds there are; files of their calibrations."""

from . import kinds as kinds
