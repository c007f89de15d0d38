"""The learnable Kalman filter: pure torch, knows no files but weights."""
