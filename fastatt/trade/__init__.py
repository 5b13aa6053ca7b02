"""Speed and error of every method, measured; advice from the measurements."""
