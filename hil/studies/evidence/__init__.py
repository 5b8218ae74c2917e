"""`hil evidence`: the accuracies a law holds over drawn stages: median and 95 % of each."""
