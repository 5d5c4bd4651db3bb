"""Parts that every controller needs: interface, estimated state, fall detection, joint command."""
