"""Dry friction as a function of the motion since the last reversal: a bank of Dahl operators, written for floats and
arrays.

Each operator is a friction of unit size that turns round over a reach D of its own, z' = x' / D - |x'| z / D (Dahl, The
Aerospace Corp. TOR-0158(3107-18)-1, 1968), here in its implicit step z <- (z + dx / D) / (1 + |dx| / D): smooth, and
stable for any dx. A weighted sum of them is the rate-independent part of the LuGre model (Canudas de Wit and others,
IEEE TAC 40(3), 1995). It is close to any generalised Maxwell-slip curve (Al-Bender and others, IEEE TAC 50(11), 2005).
"""

from hil.control.number import Number

RATIO = 2.885  # of one reach to the one before: 1 to 200 over the bank

Bank = tuple[Number, Number, Number, Number, Number, Number]  # one value an operator, finest first


def slopes(finest: Number) -> Bank:
    """1 / D of every operator, 1/m. finest: the smallest D, m."""
    s0 = 1.0 / finest
    s1 = s0 / RATIO
    s2 = s1 / RATIO
    s3 = s2 / RATIO
    s4 = s3 / RATIO
    return s0, s1, s2, s3, s4, s4 / RATIO


def moved(z: Bank, slope: Bank, way: Number) -> Bank:
    """The operators' states after `way` more (m)."""
    z0, z1, z2, z3, z4, z5 = z
    q0, q1, q2 = way * slope[0], way * slope[1], way * slope[2]
    q3, q4, q5 = way * slope[3], way * slope[4], way * slope[5]
    return (
        (z0 + q0) / (1.0 + abs(q0)), (z1 + q1) / (1.0 + abs(q1)), (z2 + q2) / (1.0 + abs(q2)),
        (z3 + q3) / (1.0 + abs(q3)), (z4 + q4) / (1.0 + abs(q4)), (z5 + q5) / (1.0 + abs(q5)),
    )  # fmt: skip


def averaged(a: Bank, b: Bank, c: Bank) -> Bank:
    """Mean over an interval of states at its beginning, middle and end."""
    return (
        0.5 * b[0] + 0.25 * (a[0] + c[0]), 0.5 * b[1] + 0.25 * (a[1] + c[1]), 0.5 * b[2] + 0.25 * (a[2] + c[2]),
        0.5 * b[3] + 0.25 * (a[3] + c[3]), 0.5 * b[4] + 0.25 * (a[4] + c[4]), 0.5 * b[5] + 0.25 * (a[5] + c[5]),
    )  # fmt: skip


def weighed(w: Bank, z: Bank) -> Number:
    """Sum of weight times value."""
    return w[0] * z[0] + w[1] * z[1] + w[2] * z[2] + w[3] * z[3] + w[4] * z[4] + w[5] * z[5]
