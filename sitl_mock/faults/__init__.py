"""What goes wrong on purpose: faults inside vehicles, impairments of their links, and what came of it all."""
