"""Does the traffic fit the segment? Worst-case response times and bus load, before the first frame."""
