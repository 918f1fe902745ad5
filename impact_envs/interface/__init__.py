"""Between users and worlds: what is handed over and checked, what is handed back, and the verdict on it."""
