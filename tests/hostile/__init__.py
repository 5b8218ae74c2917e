"""Every command in surroundings that are against it: full disks, closed descriptors, other users, early signals."""
