"""Depth and tip of a flexible tool: its runs, filters over them, registration, time alignment, calibration."""
