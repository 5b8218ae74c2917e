"""Weights of an axis' friction and inertia from the observer's innovations: one Kalman filter of random walks.

Written for floats and arrays.

Innovation = sum of weight error times what a unit of it makes of an innovation + noise (Friedland's separate estimate
of a bias, IEEE TAC 14(4), 1969). Weights: 6 operators of hil/control/laws/presliding_bank.py (N) and the mass (kg).
"""

from hil.control.number import Number, select, zeros_like

Weights = tuple[Number, Number, Number, Number, Number, Number, Number]

# Upper triangle of P by rows.
Spread = tuple[
    Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number,
    Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number,
]  # fmt: skip


def diagonal(v: Weights) -> Spread:
    """A covariance without correlations, of variances."""
    o = zeros_like(v[0])
    return (
        v[0], o, o, o, o, o, o, v[1], o, o, o, o, o, v[2], o, o, o, o, v[3], o, o, o, v[4], o, o, v[5], o, v[6],
    )  # fmt: skip


def learnt(
    p: Spread, regressors: Weights, noise: Number, more: Weights, most: Weights, learn: Number
) -> tuple[Spread, Weights]:
    """P after an innovation of variance `noise` (m^2), and what a metre of it adds to the weights.

    more: variance the weights gain in a period, as long as theirs is below `most`. learn: 1.0, or 0.0 where nothing is
    to be learnt.
    """
    r0, r1, r2, r3, r4, r5, r6 = regressors
    (
        p00, p01, p02, p03, p04, p05, p06, p11, p12, p13, p14, p15, p16, p22, p23, p24, p25, p26, p33, p34, p35,
        p36, p44, p45, p46, p55, p56, p66,
    ) = p  # fmt: skip
    h0 = p00 * r0 + p01 * r1 + p02 * r2 + p03 * r3 + p04 * r4 + p05 * r5 + p06 * r6
    h1 = p01 * r0 + p11 * r1 + p12 * r2 + p13 * r3 + p14 * r4 + p15 * r5 + p16 * r6
    h2 = p02 * r0 + p12 * r1 + p22 * r2 + p23 * r3 + p24 * r4 + p25 * r5 + p26 * r6
    h3 = p03 * r0 + p13 * r1 + p23 * r2 + p33 * r3 + p34 * r4 + p35 * r5 + p36 * r6
    h4 = p04 * r0 + p14 * r1 + p24 * r2 + p34 * r3 + p44 * r4 + p45 * r5 + p46 * r6
    h5 = p05 * r0 + p15 * r1 + p25 * r2 + p35 * r3 + p45 * r4 + p55 * r5 + p56 * r6
    h6 = p06 * r0 + p16 * r1 + p26 * r2 + p36 * r3 + p46 * r4 + p56 * r5 + p66 * r6
    total = noise + h0 * r0 + h1 * r1 + h2 * r2 + h3 * r3 + h4 * r4 + h5 * r5 + h6 * r6
    scale = learn / total
    k0, k1, k2, k3, k4, k5, k6 = h0 * scale, h1 * scale, h2 * scale, h3 * scale, h4 * scale, h5 * scale, h6 * scale
    q0 = select(p00 < most[0], more[0], 0.0) * learn
    q1 = select(p11 < most[1], more[1], 0.0) * learn
    q2 = select(p22 < most[2], more[2], 0.0) * learn
    q3 = select(p33 < most[3], more[3], 0.0) * learn
    q4 = select(p44 < most[4], more[4], 0.0) * learn
    q5 = select(p55 < most[5], more[5], 0.0) * learn
    q6 = select(p66 < most[6], more[6], 0.0) * learn
    return (
        p00 - k0 * h0 + q0, p01 - k0 * h1, p02 - k0 * h2, p03 - k0 * h3, p04 - k0 * h4, p05 - k0 * h5,
        p06 - k0 * h6, p11 - k1 * h1 + q1, p12 - k1 * h2, p13 - k1 * h3, p14 - k1 * h4, p15 - k1 * h5,
        p16 - k1 * h6, p22 - k2 * h2 + q2, p23 - k2 * h3, p24 - k2 * h4, p25 - k2 * h5, p26 - k2 * h6,
        p33 - k3 * h3 + q3, p34 - k3 * h4, p35 - k3 * h5, p36 - k3 * h6, p44 - k4 * h4 + q4, p45 - k4 * h5,
        p46 - k4 * h6, p55 - k5 * h5 + q5, p56 - k5 * h6, p66 - k6 * h6 + q6,
    ), (k0, k1, k2, k3, k4, k5, k6)  # fmt: skip
