/* Arrays of one shape, made in half of the time of numpy.empty: the shape is parsed once. */
static PyObject *new_array(PyObject *shape, PyObject *unused) {
    npy_intp *lengths = PyCapsule_GetPointer(shape, NULL);
    (void)unused;
    return lengths ? PyArray_SimpleNew((int)lengths[0], lengths + 1, NPY_DOUBLE) : NULL;
}
static PyMethodDef new_array_method = {"new_array", new_array, METH_NOARGS, "A new float64 array, its entries unset."};

static void free_shape(PyObject *shape) { free(PyCapsule_GetPointer(shape, NULL)); }

static PyObject *maker(PyObject *self, PyObject *shape) {
    (void)self;
    Py_ssize_t axes = PyTuple_Check(shape) ? PyTuple_Size(shape) : -1;
    if (axes < 0 || axes > 8) return PyErr_Format(PyExc_TypeError, "a shape is a tuple of up to 8 lengths");
    npy_intp *lengths = malloc(9 * sizeof *lengths);
    if (!lengths) return PyErr_NoMemory();
    lengths[0] = axes;
    for (Py_ssize_t i = 0; i < axes; i++) {
        lengths[i + 1] = PyLong_AsSsize_t(PyTuple_GetItem(shape, i));
        if (lengths[i + 1] < 0) {
            free(lengths);
            return PyErr_Occurred() ? NULL : PyErr_Format(PyExc_ValueError, "a length is at least 0");
        }
    }
    PyObject *kept = PyCapsule_New(lengths, NULL, free_shape), *made = NULL;
    if (kept) {
        made = PyCFunction_NewEx(&new_array_method, kept, NULL);
        Py_DecRef(kept);
    } else free(lengths);
    return made;
}
static PyObject *use(PyObject *self, PyObject *name) {
    (void)self;
    const char *wanted = PyUnicode_AsUTF8AndSize(name, NULL);
    if (!wanted) return NULL;
    for (int i = 0; i < N_VARIANTS; i++)
        if (!strcmp(wanted, variants[i].name)) {
            if (variants[i].level > level())
                return PyErr_Format(PyExc_ValueError, "this processor does not run variant %s", wanted);
            choose(i);
            return none();
        }
    return PyErr_Format(PyExc_ValueError, "there is no variant %s", wanted);
}
static PyObject *variant(PyObject *self, PyObject *unused) {
    (void)self; (void)unused;
    return PyUnicode_FromString(variants[running].name);
}
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_native", "Kempe's kernels, compiled.", -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__native(void) {
    import_array();
    const char *value = getenv("KEMPE_GUARD");
    guard = !value || !*value ? 0 : !strcmp(value, "before") ? -1 : 1;
    if (guard && !CAN_GUARD) {
        PyErr_SetString(PyExc_ImportError, "KEMPE_GUARD does not work on Windows");
        return NULL;
    }
    PyObject *module = PyModule_Create(&definition), *all = PyDict_New();
    if (!module || !all) return NULL;
    for (int i = N_VARIANTS - 1; i >= 0; i--)
        if (variants[i].level <= level()) choose(i);
    if (running < 0) {
        PyErr_SetString(PyExc_ImportError, "this processor runs none of the variants that it was compiled for");
        return NULL;
    }
    for (int i = 0; i < N_VARIANTS; i++) {
        PyObject *runs = PyBool_FromLong(variants[i].level <= level());
        if (!runs || PyDict_SetItemString(all, variants[i].name, runs)) return NULL;
        Py_DecRef(runs);
    }
    if (PyModule_AddObjectRef(module, "VARIANTS", all)) return NULL;
    Py_DecRef(all);
    if (PyModule_AddStringConstant(module, "SOURCES", "@SOURCES@")) return NULL;
    if (PyModule_AddStringConstant(module, "BUILDER", "@BUILDER@")) return NULL;
    return module;
}
