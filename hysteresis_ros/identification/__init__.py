"""Identification: from measured voltage and displacement to the parameters of models, and their validation."""
