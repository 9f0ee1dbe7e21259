"""The compiled kernel: traces of the equations as vector code, and the programs made of it."""
