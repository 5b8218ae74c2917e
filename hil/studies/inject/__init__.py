"""A batch of cells injected in virtual time: the rig's own loop, an emulated dish, a verdict for each cell."""
