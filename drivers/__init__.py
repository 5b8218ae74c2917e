"""CAN for the control service: buses, frame layouts, bus-load analysis, and a simulated segment.

Knows nothing of `hil` and `sim_plant`. Inside, imports run one way only; from the top:

    wire             the simulated segment in virtual time; ports on it count what real ones count
    bus_load         schedulability: needs to know what messages a layout sends
    families         frame layouts of each family of drives: bytes to values and back, no I/O
    protocols        what they have in common, and the way to one by its name
    bus              real buses: SocketCAN and the local bus behind one Port
    config           what a rig file says of the bus
    frame_length, arbitration      facts of ISO 11898-1 about one frame
    frame            the frame itself
    base             not CAN: where classes come from, files, the runtime directory

A module may import from its own line and from those below, never from above.
"""
