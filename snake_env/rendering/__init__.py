"""Pictures of the robot: frames, windows and GIFs."""
