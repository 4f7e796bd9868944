"""Displacements out of images: a rendered tip, its sub-pixel place in a frame, and folders and videos of them."""
