"""What the pages share: drawings, the template engine, the verdict on a seat."""
