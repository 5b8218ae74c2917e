"""What a person at a rig measures (`hil bench`), and the means all benchmarks share: blocks in turns, live runs."""
