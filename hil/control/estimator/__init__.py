"""Position and velocity from encoder samples: a Kalman filter with constant gains, and the design of those gains."""
