"""How far to believe an answer: verdicts on samples, doubts about demonstrations."""
