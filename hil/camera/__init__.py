"""`hil camera`: images of pipette and cell into readings of [sensors], in a process of its own."""
