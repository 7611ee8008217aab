"""The blind study of identification: people drawn from Table 1, identified, and looked up."""
