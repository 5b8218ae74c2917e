"""The CAN side of the rig: buses, frame layouts, a simulated wire and its schedulability analysis. Usable without hil."""
