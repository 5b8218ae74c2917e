"""The shipped rigs with their axes on two segments: can0 and can1."""

TWO = ('bus.segments=[{channel="can0",axes=["x"]},{channel="can1",axes=["y"]}]',)
TWO_PAIRS = ('bus.segments=[{channel="can0",axes=["x","y"]},{channel="can1",axes=["z","theta"]}]',)
