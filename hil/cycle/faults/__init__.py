"""One row a fault, one file a family. row.py says what a row has; nothing here runs in a tick."""
