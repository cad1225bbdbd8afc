"""The engine: C that plans contacts and evaluates them, and its binding."""
