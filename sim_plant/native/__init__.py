"""The physics of a real stage once more, in C: the same bits in a fraction of the time (docs/adr/0009)."""
