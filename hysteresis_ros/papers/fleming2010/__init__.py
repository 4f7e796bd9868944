"""Fleming, Aphale & Moheimani 2010, a new method for robust damping and tracking control."""
