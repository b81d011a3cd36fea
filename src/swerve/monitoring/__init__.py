"""Watch while it happens: a monitor of one demonstration, and the foresight that it needs."""
