"""What all packages stand on: errors, files, options, registration, seeds, the terminal."""
