"""3-vectors as tuples."""

from fastatt._jit import kernel


@kernel
def dot(a, b):
    """Scalar product a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product a×b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def add(a, b):
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def sub(a, b):
    """Difference a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(k, a):
    """Multiple k a."""
    return k * a[0], k * a[1], k * a[2]


@kernel
def axpy(k, a, b):
    """Sum k a + b."""
    return k * a[0] + b[0], k * a[1] + b[1], k * a[2] + b[2]


@kernel
def neg(a):
    """Opposite −a."""
    return -a[0], -a[1], -a[2]


@kernel
def turn_first(v, c, s):
    """v seen from axes turned about axis 1, c and s cosine and sine of the angle."""
    return v[0], c * v[1] + s * v[2], c * v[2] - s * v[1]


@kernel
def turn_third(v, c, s):
    """v seen from axes turned about axis 3, c and s cosine and sine of the angle."""
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]
