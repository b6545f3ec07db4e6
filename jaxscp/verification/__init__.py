"""An independent check of a solution."""
