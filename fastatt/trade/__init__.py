"""Speed and error of every method, on recordings and on known solutions; advice from both."""
