"""Speed and error of every method, on recordings and on known answers; advice on both."""
