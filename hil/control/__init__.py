"""The mathematics of control that a tick runs: laws, the motion filter, setpoints and trajectories; no I/O, no clock.

Imports inside the room run down this list, never up:

    setpoints                  the reference fields of a law's inputs
    trajectories               tasks as pure functions of integer nanoseconds
    estimator                  the rig's Kalman filter, the design of its gains, and what users put before the law
    nominal_model              the rig file's model as arrays
    laws                       one law a file, on floats or arrays; laws/base.py is the contract of all of them
    law_registry               names of laws, ours and users', to classes
    gain, number               how a law declares its gains; floats or arrays
"""
