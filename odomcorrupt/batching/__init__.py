"""Monte-Carlo batches: many corrupted bags of one."""
