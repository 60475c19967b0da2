# Sourced in the checkout: catkin cannot build in a path with blanks.
case "$PWD" in
    *[[:space:]]*)
        echo "the path of the checkout contains a blank: $PWD; catkin cannot build there, so move the checkout" >&2
        exit 1
        ;;
esac
