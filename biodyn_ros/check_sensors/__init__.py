"""`biodyn check-sensors`: sensors checked by others that were recorded beside them."""
