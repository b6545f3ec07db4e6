"""``python -m jaxscp``."""

from jaxscp.cli import main

if __name__ == "__main__":
    main()
