"""What balance is measured by and where it leads: DCM, support polygon, references, fall."""
