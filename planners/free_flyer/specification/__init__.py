"""What a formula asks of motions: requirements, rows, half-planes, and which of its alternatives a plan takes."""
