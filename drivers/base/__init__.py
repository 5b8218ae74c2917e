"""The ground under all packages, which is not CAN: where classes come from, files, the runtime directory."""
