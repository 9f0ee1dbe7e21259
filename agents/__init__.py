"""How each agent is made: builders, defaults and recipes."""
