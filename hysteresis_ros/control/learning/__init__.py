"""Learning from period to period: the correction that is added to the reference, its filters, and what it learned."""
