"""What the recorded events themselves say about the answer: replay, tail checks, influence."""
