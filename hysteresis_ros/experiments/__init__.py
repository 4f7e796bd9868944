"""Published experiments, repeated: each claim of a paper beside what the package finds."""
