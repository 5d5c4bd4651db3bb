"""What every controller needs: its interface, the estimated state, fall detection, the joint command."""
