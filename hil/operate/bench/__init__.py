"""What a person at a rig measures (`hil bench`), and what all benchmarks share: interleaved blocks, live runs."""
