"""Programs compiled ahead of their first call, kept in files and caches."""
