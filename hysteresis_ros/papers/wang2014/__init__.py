"""Wang, Alici & Tan 2014: Duhem model and inverse feedforward of a conducting polymer."""
