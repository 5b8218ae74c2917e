"""One pure tick: frames in, frames and a record out. No socket, no clock, no file."""
