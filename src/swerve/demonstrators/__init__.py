"""Ways to make demonstrations."""
