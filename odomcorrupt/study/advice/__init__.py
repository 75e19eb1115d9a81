"""What to drive next: which manoeuvre tells two effects apart, or shows one that this drive could not."""
