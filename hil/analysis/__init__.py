"""Questions about a loop or a task, asked before it runs: stability, margins, feasibility, where it may begin.

Nothing here is part of a tick: no I/O, no clock, arrays instead of floats. Imports inside the room run down this list,
never up:

    frequency_response         the open loop over frequency, and a measured response of the stage
    loop_corners               the loop off the nominal model: mass, resonance, lag, friction
    stability                  poles and margins of the sampled loop, by simulation of filter and law as they are
    flexible_plant, pulse_loop the loop's answer to a pulse, plants as arrays
    learning_check             whether a law that learns from repeat to repeat converges
    start_ranges               where a task may begin
    feasibility                whether a task keeps the limits
    figures_of_merit           errors and forces of a steady window
"""
