"""Light transport: ray casting, transport matrices, rendering."""
