"""What people see: pictures of fits, diagnoses, studies and calibrations, and the report that tells their story.

Needs Bokeh (``pip install "sherkit[view]"``).
"""
