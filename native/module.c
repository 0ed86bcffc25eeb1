static PyObject *use(PyObject *self, PyObject *name) {
    (void)self;
    const char *wanted = PyUnicode_AsUTF8AndSize(name, NULL);
    if (!wanted) return NULL;
    for (int i = 0; i < N_VARIANTS; i++)
        if (!strcmp(wanted, variants[i].name)) {
            if (variants[i].level > level())
                return PyErr_Format(PyExc_ValueError, "this processor does not run variant %s", wanted);
            choose(i);
            return nothing();
        }
    return PyErr_Format(PyExc_ValueError, "there is no variant %s", wanted);
}
static PyObject *variant(PyObject *self, PyObject *none) {
    (void)self; (void)none;
    return PyUnicode_FromString(variants[running].name);
}
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_native", "Kempe's kernels, compiled.", -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__native(void) {
    import_array();
    const char *wish = getenv("KEMPE_GUARD");
    guard = !wish ? 0 : !strcmp(wish, "after") ? 1 : !strcmp(wish, "before") ? -1 : 0;
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
    if (PyModule_AddStringConstant(module, "DIGEST", "@DIGEST@")) return NULL;
    return module;
}
