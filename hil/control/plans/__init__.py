"""Plans: how a goal moves an axis, from any motion in force to rest, within limits on speed, acceleration and jerk.

Every plan ends at rest inside the fence, so that whatever does not come (the next goal, a client, a lease) needs no
reaction of its own. All of it is + - * / and sqrt on doubles: the same bits on every machine and in either build.
"""
