"""Published experiments, repeated: one folder a paper, each claim beside what the package finds."""
