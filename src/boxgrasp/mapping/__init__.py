"""What is occupied, free and unseen round the target."""
