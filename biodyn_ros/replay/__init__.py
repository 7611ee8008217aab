"""`biodyn replay`: the live pipeline over a bag, and its report."""
