"""Runs to look at: what a recording, a simulation or a trace file holds, as figures, pictures, pages and tables.

`api` is what Python programs use of it, through `import hil`. Imports inside the room run down this list, never up:

    views, events, listing,    the command line's thin shells; the rest never prints, exits or reads arguments
        share
    without_code               a copy of a recording without the source that it carries
    trend, disk                drifts over runs; what runs take on the disk
    listed, index              the runs of a folder with what is known of each; a cache of it
    facts, note, kept          what a list says of a run, what a person says of it, and which runs a folder holds
    api                        rigs, runs, simulations, recordings
    report, summary, files     one HTML file; figures of a recording; exported columns
    rigs, last, class_text     rigs in Python; the newest run; the text of a class typed into a notebook
    columns                    what a run holds, by type
    trace_file, traces         trace files of CAN frames, read and written
    asc_log, candump_log       two formats that are our own
"""
