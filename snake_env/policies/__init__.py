"""Everything that chooses modes: the registry, planner, value and learned policies, shield."""
