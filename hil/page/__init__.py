"""`hil page`: rigs in a browser, from a process of its own."""
