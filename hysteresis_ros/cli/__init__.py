"""The command ``hysteresis``: thin subcommands over the rest of the package."""
