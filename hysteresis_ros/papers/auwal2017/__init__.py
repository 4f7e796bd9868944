"""Auwal et al. 2017: PID and inverse multiplicative compensation of Bouc-Wen hysteresis."""
