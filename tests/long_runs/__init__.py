"""Long campaigns on what the control process believes: loops, clocks, files and processes; slices of them are tests."""
