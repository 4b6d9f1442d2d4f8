"""Who holds the subdomains and the merged mesh: one process, or several that exchange messages."""
