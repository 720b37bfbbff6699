"""The interactive page: effects added by hand, and the error falling. Needs Bokeh (``sherkit[view]``)."""
