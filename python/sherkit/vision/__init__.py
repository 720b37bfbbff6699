"""A camera as an instrument: its intrinsics, a marker in pictures and videos, rows of pixels joined to joint readings.

Needs OpenCV (``pip install "sherkit[vision]"``).
"""
