"""Controllers and observers: kernels ``u = kernel(p, x, reference, measured)`` and the design of their gains."""
