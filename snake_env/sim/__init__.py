"""The simulation: predict and advance, the optimiser (21), masks, observations, tasks, episodes."""
