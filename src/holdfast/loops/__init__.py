"""Loop closures: places that were seen twice, found by the estimate and verified by registration of their scans."""
