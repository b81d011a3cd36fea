"""Judge how far to trust an answer: verdicts on samples, doubts about demonstrations."""
