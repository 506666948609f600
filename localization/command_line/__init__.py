"""What commands that localize a robot begin with: outset > readers; resuming (--save, --resume), publishing."""
