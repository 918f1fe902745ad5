"""Expert of the dual-arm domain: time-invariant reference spreading."""
