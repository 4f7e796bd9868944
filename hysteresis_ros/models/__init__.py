"""Forward models: from voltage to displacement, as blocks over plain arrays."""
