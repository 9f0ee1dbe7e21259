"""The paper's equations on generic scalars: each is found by searching for its number."""
