"""Published results, made from nothing: a folder for each result, beside the shared modules."""
