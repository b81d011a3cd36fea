"""Published results, made from nothing: a folder for each result; what they share lies beside."""
