"""A controller that understands GCS 2.0, with the package's plant behind each axis."""
