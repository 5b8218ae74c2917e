"""Bring-up of a rig's drives: who is there, how they took their configuration, what they send, and one axis jogged.

- drive_host.py: the rig's drives through its frame layout, without the control cycle
- frame_log.py: everything heard, by identifier, and against what the layout expects
- survey.py: the procedure without torque, tick by tick, and its report
- jog.py: the procedure with torque: one axis, one capped force, while a key is held
- session.py: runs procedures on a bus in real time; takes the rig's lock, and ends every way out with zero torque
- report_text.py: the report for people and as JSON

Procedures have no clock and no I/O: they are given the frames of a tick and the time, and return the frames to send.
"""
