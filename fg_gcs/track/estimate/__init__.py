"""What is known of targets: filters, models of motion, and several targets as one."""
