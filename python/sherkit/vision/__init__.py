"""A camera as an instrument: its intrinsics, a marker in pictures and videos.

Needs OpenCV (``pip install "sherkit[vision]"``).
"""
