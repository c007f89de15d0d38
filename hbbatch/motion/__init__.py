"""What a motion filter is, whoever computes it: constants, state columns, recursions. No torch."""
