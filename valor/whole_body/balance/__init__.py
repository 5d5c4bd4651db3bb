"""Balance: DCM, references, commanded pelvis, fall detection."""
