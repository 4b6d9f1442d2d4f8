"""Grid lines as a whole: sums of metric lengths along them, and their corrections in the windows of subdomains."""
