"""Watch a demonstration while it happens: the monitor, and the foresight that a monitor needs."""
